"""What integrates the motion: C MuJoCo and PyBullet, which the host steps, and MJX."""
