"""The streaming encoder: windows of samples to labelled segments, compositions and behaviours."""
