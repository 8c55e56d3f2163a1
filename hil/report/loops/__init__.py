"""The result of `hil hysteresis` as tables, JSON, chart and page."""
