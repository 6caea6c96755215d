"""Methods compared over paired seeds: statistics, curves, figures and the report. Plain data in, no Drake."""
