"""Pages, figures and tables of results; views of the scene in Meshcat."""
