"""Figure and page of a comparison of controllers."""
