"""A record of `phm gcs --record`, shown on the page at any speed."""
