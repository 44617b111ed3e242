"""What all figures share: style, axes, colours, panels and files."""
