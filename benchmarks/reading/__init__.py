"""How long it takes to read a million bodies in each format, and to write predictions in each."""
