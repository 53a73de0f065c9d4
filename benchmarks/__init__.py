"""Every figure that README and docs state, each from one command."""
