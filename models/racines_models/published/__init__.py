"""The published weights: `places` finds them, `catalogue` says what each is, and if it is whole."""
