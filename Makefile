.PHONY: docs-figures
docs-figures:  ## draw every figure of the docs again, each by one estlab command
	python docs/figures.py
