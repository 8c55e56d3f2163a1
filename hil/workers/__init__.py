"""Distribute work over processes of this computer or over a Dask cluster; both have the same small interface."""
