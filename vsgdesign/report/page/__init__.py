"""What every page shares: the skeleton, and PDF."""
