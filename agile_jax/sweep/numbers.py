"""The numbers of the stages' summaries, by which trials can be compared. Others are refused before any work."""

import difflib

_TABLES = {"branches", "failed", "failures", "methods", "outcomes_by_region", "rescued"}  # of numbers by name
_NAMES = {
    "dataset": """
        attempted branches certified_fraction drawn_starts duration_s_median failed labels_per_second
        max_bound_violation max_clearance_violation_m max_dynamics_residual max_end_residual
        max_integration_defect methods min_clearance_m optimality_gap_median optimality_gap_p95
        rejected_starts rejected_starts_bounds rejected_starts_collision rescued solve_time_ms_median
        trajectories unverified workers""",
    "training": """
        aggregation_answered aggregation_asked chosen_seed compile_seconds epochs field_arrived_rate
        field_collision_rate field_final_error_m_max field_final_error_m_median field_headroom
        field_min_clearance_m field_min_clearance_m_p05 field_stall_rate field_starts
        field_time_ratio_median field_time_ratio_p95 field_time_ratio_p99 field_timeout_rate kept_epoch
        label_variance noise_floor_mse noise_floor_mse_own_units noise_floor_share parameters seconds
        test_mse test_mse_over_noise_floor test_mse_own_units test_mse_seeds_max test_mse_seeds_min
        train_mse training_samples validation_mse""",
    "evaluation": """
        arrival_time_ratio_median arrival_time_ratio_p95 arrival_time_ratio_quantiles
        arrival_time_ratio_same_tolerance_median arrival_time_ratio_same_tolerance_p95
        arrival_time_ratio_same_tolerance_quantiles cone_violations cost_of_transport_quantiles episodes
        expert_failures failures final_error_m_median joint_violations min_clearance_m_p05
        min_clearance_m_quantiles min_envelope_clearance_m_quantiles min_self_clearance_m_p05
        min_self_clearance_m_quantiles mpc_failures mpc_infeasible
        mpc_not_finite mpc_solutions mpc_unconverged outcomes_by_region planning_ms_per_query_median
        rejected_starts_bounds_share rejected_starts_collision_share rejected_starts_share seconds self_overlaps
        simulated_seconds_per_second stance_saturations success_rate success_rate_high success_rate_low
        success_rate_where_path torque_saturation_fraction torque_saturation_quantiles torque_violations
        velocity_tracking_rmse velocity_tracking_rmse_quantiles""",
}
NUMBERS = {stage: tuple(names.split()) for stage, names in _NAMES.items()}


def number_error(metric: str) -> str | None:
    """Why no trial can have a metric such as "training.validation_mse"; None when one can."""
    stage, *keys = metric.split(".")
    backend = [keys.pop(0)] if stage == "evaluation" and keys else []
    if stage not in NUMBERS or not keys:
        return "must be a number of a stage's summary: 'training.validation_mse', 'evaluation.mujoco.success_rate', ..."
    if keys[0] in NUMBERS[stage] and (len(keys) == 1 or keys[0] in _TABLES or keys[0].endswith("_quantiles")):
        return None
    near = difflib.get_close_matches(keys[0], NUMBERS[stage], 1)
    hint = f"did you mean '{'.'.join([stage, *backend, near[0]])}'? " if near else ""
    return f"no summary has this number; {hint}There are {', '.join(NUMBERS[stage])}"
