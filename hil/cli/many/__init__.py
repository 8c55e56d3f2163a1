"""Commands over many recordings: of a list, of a campaign, of a folder."""
