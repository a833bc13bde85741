"""The published servo at work on one patient, as a page, a film and figures."""
