"""Every table and figure of the project, each from one command."""
