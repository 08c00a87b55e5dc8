"""What `import agile_jax as aj` offers beside the stages: solve, open_run, run, make_dataset, train (docs/python.md).

The command line uses the same objects.
"""
