"""The main job: rendered budget beside the closed form over range, its verdict, advice and report."""
