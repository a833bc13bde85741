"""What `racines doctor` looks at: packages, machine, files. Nothing heavy is imported."""
