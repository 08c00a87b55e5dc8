"""The solver of the MPC's quadratic program: three passes (cascade.py), batched by vmap."""
