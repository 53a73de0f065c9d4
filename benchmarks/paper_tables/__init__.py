"""The tables of Kudo et al. 2018: the published rows, and beside them what is fitted here."""
