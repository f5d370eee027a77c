"""The network: from images and lines of sight to poses. Knows of no file and no data set."""
