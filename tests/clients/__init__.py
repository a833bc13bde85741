"""Other people's learners on the tasks, each in an environment of its own: `make test-clients`."""
