"""The random streams: which numbers set apart what is drawn under one seed.

Each purpose draws from a seed sequence (seed, stream, ...). Two streams of the benchmark have numbers of the kinematic
test; changing either would change results, and no draw is shared: the benchmark's generators are of another kind.
"""

LABEL_STARTS = 1  # (seed, 1, label)
SPLIT = 2  # (seed, 2): which trajectories are for training, validation, test
SAMPLE_SPLIT = 3  # (seed, 3): the same for single samples
EVALUATION_STARTS = 7_001  # (seed, 7001, evaluation.seed)
KINEMATIC_TEST_STARTS = 7_002  # (seed, 7002): after training
INTERMEDIATE_TEST_STARTS = 7_003  # (seed, 7003): between epochs
AGGREGATION_STARTS = 7_004  # (seed, 7004, round)
PLANTS = 7_005  # (seed, 7005, evaluation.seed, episode)
SENSORS = 7_006  # (seed, 7006, evaluation.seed, episode)
DISTURBANCES = 7_002  # (seed, 7002, episode), of the tracking benchmark
COMMANDS = 7_003  # (seed, 7003, episode), of the tracking benchmark
