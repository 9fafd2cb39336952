"""Tasks, classifiers, cross-validation and metrics on feature matrices."""
