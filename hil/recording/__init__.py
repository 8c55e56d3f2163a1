"""The recording on disk: its reader, its writer, and the path it is written to."""
