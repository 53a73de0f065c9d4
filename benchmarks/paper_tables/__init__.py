"""The tables of Kudo et al. 2018, with the published rows and fits of uplift."""
