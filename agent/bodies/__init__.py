"""Bodies: the sensors and motors of real robots, behind `Sense` and `Move`."""
