"""Image generators, the grader, and their scores."""
