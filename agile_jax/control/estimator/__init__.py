"""What the robot knows of itself: its state from an IMU, encoders and what its feet feel.

`measured.py` says what sensors tell, `kalman.py` has the linear filter, `estimator.py` the robot's.
"""
