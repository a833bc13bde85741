"""Patients: simulated hearts that nobody trained on, which beat and breathe."""
