"""python -m signorini"""

from signorini.cli.main import main

if __name__ == "__main__":
    main()
