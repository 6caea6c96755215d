"""The robot's own eyes: images to tag detections, depth images to scans, calibrations, tags to print. No Drake."""
