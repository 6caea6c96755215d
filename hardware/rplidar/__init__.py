"""The RPLidar A1 to A3 on its serial port."""
