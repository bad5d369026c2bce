from dgeval.cli import main

main()
