"""Mutation testing: small bugs put into the code one at a time, and the share that the tests notice."""
