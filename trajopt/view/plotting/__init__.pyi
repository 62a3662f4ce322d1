from .writing import write_plots as write_plots
from .writing import write_push_plot as write_push_plot
