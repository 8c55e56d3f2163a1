"""`hil studio`: a page on this computer that starts hil's commands, and shows the files and the JSON they write."""
