"""Topic rates: one `TopicMonitor` for each configured topic, its `RateEstimator`, and the statistics of each publisher."""
