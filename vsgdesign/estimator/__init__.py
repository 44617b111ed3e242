"""Grid impedance from measured windows: data sets, network, training, and what can be known at all."""
