"""What a benchmark runs: recorded problems, commands, disturbances, training steps."""
