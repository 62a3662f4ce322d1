"""Scripts for those who work on the library, run from its clone: measurements, the gallery, the fronts."""
