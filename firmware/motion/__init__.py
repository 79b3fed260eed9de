"""From a target in millimetres to segments of steps: planner, segments and their kernels."""
