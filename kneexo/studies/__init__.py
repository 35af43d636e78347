"""The studies. Each study is a package that compares many scenarios and reports its findings."""
