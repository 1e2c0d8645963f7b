"""From a configuration to objects: the one place that knows everything, and that loads drivers, by name."""
