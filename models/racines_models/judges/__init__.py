"""Networks that read images: grader and fast student, pose regressor, segmentation judge."""
