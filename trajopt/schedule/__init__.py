"""Who touches when: phases and their contacts, gaits, footholds, targets of contacts."""
