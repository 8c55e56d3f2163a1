"""Work spread over processes of this computer or over a Dask cluster, through one narrow executor."""
