"""What every figure shares: style, axes, colours, panels, and files."""
