"""What a user hands in: a study with its fields, and the datasheet from which a study is made."""
