"""From a suite to stored fits: plan the cells, calibrate each, keep what came out."""
