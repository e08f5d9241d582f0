"""The flagship question: the nominal model leaves out eleven effects at once. Can the engine name them and mend it?"""
