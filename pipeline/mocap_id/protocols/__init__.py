"""Analysis specific to a movement (sit-to-stand, robot joint, reach, curl): repetitions, contact, reference body."""
