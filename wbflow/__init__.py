"""wbflow: a metric, coloured point cloud of a site, every night, from fixed cameras far apart."""

__version__ = "0.1.0"
