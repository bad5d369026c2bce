from dgeval.cli import app

app(prog_name="dgeval")
