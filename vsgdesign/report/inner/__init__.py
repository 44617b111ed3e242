"""The page of designed inner loops."""
