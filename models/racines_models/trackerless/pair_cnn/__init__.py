"""A small convolutional network that reads the motion between two frames from both images."""
