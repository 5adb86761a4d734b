"""One experiment: records, filters, sums, results."""
