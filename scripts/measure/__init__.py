"""Measurements that the documents cite and no subcommand of ``trajopt`` makes; run from a clone."""
