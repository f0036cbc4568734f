import re,subprocess,pathlib
root=pathlib.Path('.')
names=set()
src={p:p.read_text() for p in [*root.glob('arpd/**/*.py'),*root.glob('scripts/**/*.py'),*root.glob('tests/**/*.py')] if '.venv' not in str(p)}
alltext='\n'.join(src.values())
defs=set(re.findall(r'(?:class|def)\s+(\w+)',alltext))|set(re.findall(r'^\s*(\w+)\s*[:=]',alltext,re.M))|set(re.findall(r'self\.(\w+)',alltext))
mods={'.'.join(p.with_suffix('').parts) for p in src if p.parts[0]=='arpd'}
for p,t in src.items():
    if p.parts[0]!='arpd': continue
    for m in re.finditer(r'(?<!`)`([A-Za-z_][\w.]*)`(?!`)',t):
        n=m.group(1)
        if n.startswith('arpd.'):
            ok=n in mods or n.rpartition('.')[0] in mods and n.rpartition('.')[2] in defs or n.rpartition('.')[0].rpartition('.')[0] in mods or (root/n.replace('.','/')).is_dir()
        else:
            ok=all(x in defs or x in mods for x in n.split('.')[-1:])
        if not ok: print(p,t[:m.start()].count('\n')+1,n)
    for m in re.finditer(r'\b((?:arpd|docs|tests|scripts|etc|systemd)/[\w./-]+\.\w+)',t):
        if not (root/m.group(1)).exists(): print('PATH',p,t[:m.start()].count('\n')+1,m.group(1))
    for m in re.finditer(r'docs/design\.md, ([A-Z][\w ]+?)[.)\n,;]',t):
        sec=m.group(1).strip()
        if not re.search(r'^#+ '+re.escape(sec)+r'$',(root/'docs/design.md').read_text(),re.M) : print('SEC',p,sec)
