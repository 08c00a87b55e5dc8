"""The programs that solve a route: the certified closed form, and the general nonlinear program with its retries."""
