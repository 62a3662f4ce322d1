from .writing import write_plots as write_plots
