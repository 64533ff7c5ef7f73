"""The simulation and its plans in the browser, live: what goes on in it (live), and how it is shown (page)."""
