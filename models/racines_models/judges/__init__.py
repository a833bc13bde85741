"""Networks that read images: the grader, its fast student, the pose regressor."""
