"""Network models that another program has written: read, checked, and reduced to the impedance at a bus."""
