"""A target drawn at true scale: shapes in millimetres, laid out on paper, written as PDF or SVG."""
