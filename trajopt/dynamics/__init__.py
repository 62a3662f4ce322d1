"""Numeric and symbolic rigid-body dynamics with contacts: what the optimisation is compared with."""
