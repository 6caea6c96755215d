"""The page that shows a mission, while it runs and afterwards: its files, and the server that serves it. No Drake."""
