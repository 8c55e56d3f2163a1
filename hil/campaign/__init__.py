"""Campaigns of many recordings: the plan, the recordings done so far, their results, and the report."""
