"""The search for routes: which sequences of regions there are, and lower bounds on what each costs."""
