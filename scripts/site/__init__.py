"""The site of the documentation: pages of reference, of the notebooks and of the gallery, from the code."""
