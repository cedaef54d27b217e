"""Parts of the Denso case study: experiments, estimates, tables and pictures."""
