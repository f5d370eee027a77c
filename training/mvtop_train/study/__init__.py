"""Methods, models and data sets compared and looked at: the tables and pictures of the docs."""
