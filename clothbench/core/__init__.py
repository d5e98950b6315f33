"""The words of the house: records, protocols and errors that everything else is written in. Needs numpy only."""
