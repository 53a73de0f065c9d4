"""Networks and lifters, and prediction with them."""
