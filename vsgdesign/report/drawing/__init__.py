"""What all figures and pages share: style, axes, colours, panels, files, and how a number is written."""
