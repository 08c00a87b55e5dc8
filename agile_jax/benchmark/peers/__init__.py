"""What we are compared with: each peer as its authors recommend it."""
