"""The learner's own test: a kinematic robot follows the policy from starts that no training has seen."""
