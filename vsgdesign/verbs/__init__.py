"""What a user can ask for: the work of each verb, the command line, and the functions of ``import vsgdesign``."""
