"""The probe driven by hand, from the keyboard of a terminal."""
