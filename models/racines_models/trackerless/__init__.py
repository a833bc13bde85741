"""The probe's motion from images alone: sweeps, metrics, submissions, floors, and a baseline."""
