"""What doughnet is compared with: the same sequences, predicted in other ways."""
