"""The live page: missions in a browser, while they fly and after."""
