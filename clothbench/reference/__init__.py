"""What models are held against and what stand-in truth is made with; shares no code with any model."""
