"""The probe's motion from images alone: sweeps, metrics, submissions, floors, a learned baseline."""
