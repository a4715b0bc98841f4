"""Data sets from renders, training, and the evaluation of detectors on labelled pictures."""
