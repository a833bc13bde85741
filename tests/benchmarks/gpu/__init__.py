"""What one GPU does, in order of value, in one file that grows part by part: `make gpu`."""
