"""What cameras see: drawn surfaces, rendered stripes, and the orientation of what was filmed."""
