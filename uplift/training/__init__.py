"""Lightning modules that train a lifter, and what watches over them."""
