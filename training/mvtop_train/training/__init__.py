"""From a config file and a data set to weights."""
