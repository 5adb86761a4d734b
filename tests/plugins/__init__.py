"""Problems as a user writes them, each in one file that knows nothing of the others."""
