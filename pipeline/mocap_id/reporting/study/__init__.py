"""The pages of studies: tables and figures in the form of the thesis's."""
