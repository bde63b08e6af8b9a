"""Analysis of one kind of movement (sit-to-stand, robot joint, reach, curl): repetitions, contact, reference body."""
