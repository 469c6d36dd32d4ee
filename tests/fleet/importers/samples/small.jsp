# Fisher and Thompson 1963, the first two jobs on three machines
2 3
2 1 0 3 1 6
1 8 2 5 0 10
