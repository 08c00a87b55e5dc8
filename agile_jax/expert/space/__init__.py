"""Free space: the convex regions of poses between the obstacles, and how they join."""
