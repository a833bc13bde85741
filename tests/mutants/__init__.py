"""Mutation tests of what the numbers rest on; see README.md beside this file."""
