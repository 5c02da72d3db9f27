"""A robot's mind: map, polygons, teammates, plans; and the process that houses it."""
