"""The application around the searches: command line, session, report, pictures."""
