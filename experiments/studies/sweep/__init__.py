"""Many scenarios into one labelled dataset: plan, journal, plot."""
