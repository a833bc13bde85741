"""The published weights: `places` finds them, `catalogue` says what each is, `hub` fetches them."""
