"""Object masks: finding the files, their labels, and which labels are the object."""
