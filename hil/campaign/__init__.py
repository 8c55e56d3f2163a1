"""Campaigns: the plan of many recordings, what is done of it, its results and their report."""
